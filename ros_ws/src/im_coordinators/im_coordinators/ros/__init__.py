"""ROS shell of im_coordinators."""
