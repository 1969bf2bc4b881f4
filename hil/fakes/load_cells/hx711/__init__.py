"""The emulated load cells under the fan, and the microcontroller that sends their counts."""
