"""Chaos: what the machine does when its processes die or hang, its files are damaged and its time jumps."""
