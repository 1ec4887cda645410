"""Vision Module Managers: control of contention for Vision Modules (paper, section 5)."""

from im_vss.managers.vmm import Lease, ModuleState, VisionClient, VisionModuleManager

__all__ = ["Lease", "ModuleState", "VisionClient", "VisionModuleManager"]
