"""Services: what the user of the Vision Services System deals with, each a sequence of Tools (paper, section 5)."""

from im_vss.services.service import VisionService

__all__ = ["VisionService"]
