"""Vision Module Managers: they control contention for Vision Modules (paper, section 5)."""

from im_vss.managers.lease import Lease, VisionClient
from im_vss.managers.vmm import ModuleState, VisionModuleManager

__all__ = ["Lease", "ModuleState", "VisionClient", "VisionModuleManager"]
