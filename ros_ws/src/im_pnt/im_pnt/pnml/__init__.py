"""PNML (ISO/IEC 15909-2) to nets, and nets to PNML."""

from im_pnt.pnml.read import load_pnml
from im_pnt.pnml.write import pnml_text

__all__ = ["load_pnml", "pnml_text"]
