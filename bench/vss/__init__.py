"""Figures of the Vision Services System: frames, Services, and where their time goes."""
