"""Run cells for a configuration or a multirun, then write tables and the report."""
