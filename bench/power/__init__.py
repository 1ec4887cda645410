"""Loss of power, without a plug."""
