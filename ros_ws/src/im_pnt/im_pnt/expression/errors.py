"""What can go wrong with expressions."""


class ExpressionError(ValueError):
    """An expression that cannot be read, has no type, or cannot be evaluated; the message says why."""
