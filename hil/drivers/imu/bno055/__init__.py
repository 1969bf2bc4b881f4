"""The Bosch BNO055 on its UART."""
