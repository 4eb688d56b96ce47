"""Presentation of finished experiments: pictures and the HTML report."""
