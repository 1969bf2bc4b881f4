"""Two load cells with HX711 converters, on a CAN node or on a serial line."""
