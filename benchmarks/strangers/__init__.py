"""Strangers' files: packs, records, models, scenes that nobody honest wrote, each read in a watched child process."""
