"""What each skip saves and costs: variants of a cell with the skip on and off."""
