"""Topics of ``/mcs``: what it publishes of itself and of each layer, and those that drive a layer."""
