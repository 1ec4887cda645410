"""What the machine and its parts achieve, next to baselines and peers of the same run."""
