"""Look at the models of cells in the browser."""
