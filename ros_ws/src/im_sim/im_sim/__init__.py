"""The simulated testbed: two PUMAs on carts in pybullet, driven by torques, behind the testbed link."""
