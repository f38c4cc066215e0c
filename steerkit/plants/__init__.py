"""Plants: cars, the motor at the steering wheel, the speed driver and the sensors."""
