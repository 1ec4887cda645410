"""ROS shell of the Petri net transducers: translates messages, decides nothing."""
