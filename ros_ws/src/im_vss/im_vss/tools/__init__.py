"""Tools: a call of a Vision Module with the computations before and after the call (paper, section 5)."""

from im_vss.tools.tool import ModuleAccess, Tool

__all__ = ["ModuleAccess", "Tool"]
