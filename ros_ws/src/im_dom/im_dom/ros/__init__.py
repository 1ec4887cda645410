"""ROS shell of im_dom."""
