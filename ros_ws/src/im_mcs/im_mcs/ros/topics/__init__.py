"""Topics of ``/mcs``: the published ones of the node and of each layer, and the ones to drive a layer."""
