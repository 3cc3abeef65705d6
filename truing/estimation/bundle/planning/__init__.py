"""Where to stand with a camera: candidate stations, what they see, which of them are chosen, what that is good for."""
