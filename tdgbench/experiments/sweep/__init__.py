"""A sweep of cells: plan, cells, tables, pictures, report."""
