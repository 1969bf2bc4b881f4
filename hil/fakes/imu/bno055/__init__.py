"""The emulated BNO055: register map, UART firmware, sensors and fusion."""
