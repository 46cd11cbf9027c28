"""Orders to a device as Modbus requests, and the comparison of its registers with them."""
