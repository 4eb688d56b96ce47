"""Kills: sweeps that signals and a full disk end at random moments, resumed and compared with an undisturbed one."""
