"""Services, the operations offered to users of VSS, each a sequence of Tools (paper, section 5)."""

from im_vss.services.service import VisionService

__all__ = ["VisionService"]
