"""Messages to messages: pure stages under the contract of `tramstream.processor`."""
