"""What all drivers of real devices share: the mailbox of a servo loop, the mapping into the scene, libraries, words."""
