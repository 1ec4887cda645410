"""Live display of nets (paper, section 6): any number of viewers, each with the choice of parts."""
