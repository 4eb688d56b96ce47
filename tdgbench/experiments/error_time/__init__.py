"""Quality of the test views against training time: curves, and what each step adds to the speed-up."""
