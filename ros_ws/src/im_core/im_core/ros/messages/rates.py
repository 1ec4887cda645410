"""Timing of functions in rate groups as diagnostics."""

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from im_core.rate_groups import LATENESS_S, RateStatistics


def rate_status(of: str, statistics: RateStatistics) -> DiagnosticStatus:
    """Return the status of a function: ERROR if it is called no more."""
    each = f"{statistics.times} in a period" if statistics.times > 1 else f"every {statistics.every}"
    status = DiagnosticStatus(name=f"{of}: {statistics.name}", message=statistics.ended or each)
    status.level = DiagnosticStatus.ERROR if statistics.ended else DiagnosticStatus.OK
    values = {
        "every": statistics.every,
        "times": statistics.times,
        "calls": statistics.calls,
        "missed": statistics.missed,
        "share_of_period": f"{statistics.share:.4f}",
        "mean_s": f"{statistics.mean_s:.6f}",
        "longest_s": f"{statistics.longest_s:.6f}",
    }
    bounds = (*(f"late_below_{bound:g}_s" for bound in LATENESS_S), "later")
    values |= dict(zip(bounds, statistics.lateness, strict=True))
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return status
