"""The numerical stress suite: named cases with expected and observed behaviour."""
