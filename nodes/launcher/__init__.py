"""Start the nodes of a launch file, supervise them and end them."""
