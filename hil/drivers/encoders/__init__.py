"""External encoders of the steering axes."""
