"""Networks of many stations, registered and adjusted together."""
