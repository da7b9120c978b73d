"""The browser page that shows cameras live: server, access, images, driving."""
