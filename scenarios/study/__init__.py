"""Studies of constraint uncertainty: what happens when the controller's A is wrong."""
