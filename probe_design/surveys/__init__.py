"""Survey a tissue press by press: its record, its maps, and a virtual tissue that holds tumours."""
