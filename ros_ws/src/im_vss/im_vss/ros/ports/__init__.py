"""Ports: conversion between the messages of each Service and the requests and results."""

from im_vss.ros.ports.port import Port, TriggerPort

__all__ = ["Port", "TriggerPort"]
