"""Download the published data sets: resumable, checked against published sums, unpacked whole or not at all."""
