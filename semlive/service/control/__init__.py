"""The daemon: control loop, device links, operator, analysis events."""
