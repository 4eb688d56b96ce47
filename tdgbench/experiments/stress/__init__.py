"""The numerical stress suite: named cases, each with what is expected and what was seen."""
