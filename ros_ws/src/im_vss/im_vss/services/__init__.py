"""Services: what the user of the Vision Services System deals with, each a sequence of Tools (paper, section 5)."""

from im_vss.services.service import Service

__all__ = ["Service"]
