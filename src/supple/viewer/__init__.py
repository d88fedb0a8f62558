"""The window: a picture, a clip or a volume, and a hand that bends it."""
