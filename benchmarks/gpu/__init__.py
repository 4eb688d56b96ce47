"""What the GPU backends do on a machine: tests, checks, trainings, profiles of steps; within a time limit."""
