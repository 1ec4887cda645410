"""Topics of ``/mcs``: the published ones of the node and of each layer, and those that drive a layer."""
