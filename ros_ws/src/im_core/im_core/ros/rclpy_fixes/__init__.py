"""Mends of rclpy and its middleware, one module a fault; each goes once upstream has mended it."""
