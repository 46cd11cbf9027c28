"""Triggers for the remote interfaces of microscopes. None of them has been tried at a microscope yet."""
