"""Petri net transducers (paper, section 6): nets, their execution, their analysis, their drawing."""
