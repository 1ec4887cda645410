"""ROS shell of im_dispatcher."""
