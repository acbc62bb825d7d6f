"""What the whole-body scenarios are made of: scenes, guides, metrics, pictures."""
