"""Nodes that measure: a bare topic, tokens between nets, and a node whose actions all wait."""
