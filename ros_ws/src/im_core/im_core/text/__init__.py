"""Texts of formats: YAML and JSON to plain values, in bounded time and memory for any text."""
