"""Brings the Intelligent Machine up and down: deployment, start-up phases, task registry, recording and replay."""
