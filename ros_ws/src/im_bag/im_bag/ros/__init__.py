"""ROS shells of recordings: the recorder, and the replay onto topics."""
