"""Fixes of rclpy and the middleware, one module per fault; each fix goes after the upstream fix."""
