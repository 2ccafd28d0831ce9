"""From performed time to notation: metre, hands, voices, note values, keys and spelling."""
