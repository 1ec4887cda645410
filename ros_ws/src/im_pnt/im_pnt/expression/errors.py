"""Errors of expressions."""


class ExpressionError(ValueError):
    """Unreadable, untyped or undefined expression; the message gives the reason."""
