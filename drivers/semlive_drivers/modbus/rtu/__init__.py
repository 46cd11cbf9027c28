"""Modbus RTU on serial lines, shared by several devices."""
