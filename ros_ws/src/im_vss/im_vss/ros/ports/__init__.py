"""Ports: how the messages of each Service become its requests, and its results messages."""

from im_vss.ros.ports.port import Port, TriggerPort

__all__ = ["Port", "TriggerPort"]
