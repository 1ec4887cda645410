"""The four Coordinators (paper, section 6): experts of motion, grippers, vision and path planning."""
