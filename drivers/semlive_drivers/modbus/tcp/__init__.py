"""Modbus TCP links and stops that are written without waiting for an answer."""
