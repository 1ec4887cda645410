"""``im topic``, ``service``, ``action``, ``node``, ``lifecycle``, ``param``: the verbs of ros2cli, thin over rclpy."""
