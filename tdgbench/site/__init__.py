"""`tdgbench site PACK ... DIR`: static pages from packs, for any web host or to open from disk."""
