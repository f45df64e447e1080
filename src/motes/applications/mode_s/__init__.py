"""Messages of aircraft transponders (Mode S, ADS-B) decoded from a radio recording of 1090 MHz, bits as modes of a jump-Markov system."""
