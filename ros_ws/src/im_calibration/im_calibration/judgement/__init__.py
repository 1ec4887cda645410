"""What an estimate is worth: checks, expected errors, scale, verdicts. Knows problem and estimation."""
