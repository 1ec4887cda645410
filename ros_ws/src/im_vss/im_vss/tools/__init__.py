"""Tools: a call of a Vision Module with what has to be computed before and after it (paper, section 5)."""

from im_vss.tools.tool import ModuleAccess, Tool

__all__ = ["ModuleAccess", "Tool"]
