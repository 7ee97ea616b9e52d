"""Self-contained HTML reports: pages from escaped pieces, figures without a display, one per subject."""
