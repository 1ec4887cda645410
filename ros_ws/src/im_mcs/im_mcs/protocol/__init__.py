"""What the node and the servo process share: requests, channel, samples, signs of life."""
