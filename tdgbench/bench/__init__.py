"""Running a cell: options, locks, phases, failures, and its line on the terminal."""
