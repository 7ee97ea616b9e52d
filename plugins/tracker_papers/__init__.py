"""The five papers: their scenarios and, as they land, their published numbers and reproductions."""
