"""Section 4.4: complete place recognisers, each behind the contract of `place_recognition.recognizer`."""
