"""Metrics by what they measure: functions, and a description of each. New files need no registration."""
