"""Figures of the page: frames a second of a large net in a browser, and the price of many viewers."""
