"""The estimate: start values, maximum likelihood, gates, covariance. Knows the problem only."""
