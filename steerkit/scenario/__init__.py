"""What is driven: course, car, disturbances, what the controllers are told; one drive or many."""
