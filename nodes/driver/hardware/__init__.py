"""Common parts of real-device drivers: mailbox, mapping into the scene, libraries, texts."""
