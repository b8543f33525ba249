"""Whether the configuration fits what the sensors say: mounting, scales, clocks, lever arm."""
