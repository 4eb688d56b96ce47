"""Names that every table shares: its key columns and the rows of averages."""

KEYS = ["method", "dataset", "group", "scene", "metric"]
AVERAGE, OVERALL = "Average", "Average (Overall)"
