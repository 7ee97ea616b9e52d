"""What the site adds to Sphinx: reading our docstrings, pages from the registry, drawn pictures."""
