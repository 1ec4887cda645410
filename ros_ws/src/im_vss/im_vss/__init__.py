"""The Vision Services System (paper, section 5): images in, places out, as vision Services.

Services are sequences of Tools, Tools use Vision Modules, which their managers lend; ``config/catalogue.yaml`` lists
all of them, and ``config/vss.yaml`` those in use. ``spot``, ``edges`` and ``laser`` find these in images, ``ros`` has
node and messages. What takes the images is a frame source that ``vss.yaml`` names. Of our packages it knows `im_core`,
`im_cell` and `im_calibration`.
"""

from im_vss.catalogue import Catalogue, load_catalogue
from im_vss.modules import VisionModule
from im_vss.rig import Rig
from im_vss.services import VisionService
from im_vss.settings import VssSettings, load_settings
from im_vss.tools import Tool
from im_vss.vsm import VisionServicesManager

__all__ = [
    "Catalogue",
    "Rig",
    "Tool",
    "VisionModule",
    "VisionService",
    "VisionServicesManager",
    "VssSettings",
    "load_catalogue",
    "load_settings",
]
