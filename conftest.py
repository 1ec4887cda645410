"""What holds for all tests, those of the packages and those with nodes."""

from hypothesis import HealthCheck, settings

# A verdict is of the code: not of how fast this computer is, nor of which cases are drawn today.
# ``--hypothesis-profile default`` draws other cases each time.
settings.register_profile(
    "same_everywhere", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same_everywhere")
