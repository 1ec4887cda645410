"""Keys of net files; ``schema/net.schema.json`` explains them to editors."""

FRAGMENT = ("include", "templates", "use", "places", "services", "rest", "transitions")
NET = ("net", "description", "escalate", *FRAGMENT)
TEMPLATE = ("parameters", "places", "services", "rest", "transitions")
USE = ("template", "for", "with")

PLACE = ("tokens", "capacity", "data_object", "on_invalid", "remote")
SERVICE = ("entry", "done", "failed")
ACTIONS = ("action", "service", "goal", "topic", "request")
TRANSITION = (
    *("in", "out", "inhibitors", "guard", "symbol", "emit"),
    *ACTIONS,
    *("on_failure", "on_doubt", "timeout", "delay", "success", "weight", "strategy", "priority"),
)
STRATEGY = ("successes", "failures", "decay")
CALL = {
    "service": ("name", "type", "request", "build", "handle", "task"),
    "goal": ("name", "type", "goal", "build", "handle", "task"),
    "topic": ("name", "type", "message", "build"),
    "request": ("to", "arguments", "build"),
}
"""Keys of the actions that are a mapping."""

DELAY = {
    "constant": ("value",),
    "exponential": ("rate", "mean"),
    "uniform": ("low", "high"),
    "triangular": ("low", "high", "mode"),
    "gamma": ("shape", "scale"),
    "weibull": ("scale", "shape"),
    "lognormal": ("mu", "sigma"),
}
"""Parameters of the distributions; the two of ``exponential`` are one or the other."""
