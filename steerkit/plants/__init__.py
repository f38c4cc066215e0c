"""Plants: cars, the motor at the steering wheel, the human at the pedals and the sensors."""
