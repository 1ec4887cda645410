"""SROS 2 for a deployment: enclaves, permissions and a keystore in the layout that rcl reads."""
