"""Joint drives: from the commanded torque to the torque that arrives at the joint."""
