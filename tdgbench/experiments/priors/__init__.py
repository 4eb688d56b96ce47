"""What each depth prior is worth: its error, and TDg's scores with it, next to TDg without depth."""
