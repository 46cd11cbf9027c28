"""The campaign against load frames that misbehave: scenarios, the real daemon, what the device recorded, and the verdicts."""
