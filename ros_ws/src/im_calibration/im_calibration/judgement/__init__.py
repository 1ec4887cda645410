"""Judgement of an estimate: checks, expected errors, scale, verdicts; depends on problem and estimation."""
