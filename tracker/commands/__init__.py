"""Commands of ``tracker`` that do heavier work than printing what is installed; one module for each."""
