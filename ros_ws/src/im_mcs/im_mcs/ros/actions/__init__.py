"""Actions of groups: their servers, and the motions on their way through the servo for which goals stand."""
