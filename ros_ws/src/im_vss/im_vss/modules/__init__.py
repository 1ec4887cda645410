"""Vision Modules: each owns one piece of hardware and is single-threaded by construction (paper, section 5)."""

from im_vss.modules.module import VisionModule

__all__ = ["VisionModule"]
