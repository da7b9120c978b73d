"""A page in the browser that shows cameras live: what is drawn, how it is sent, who may look."""
