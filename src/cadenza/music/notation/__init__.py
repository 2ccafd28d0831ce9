"""Turn performed time into notation: metre, hands, voices, note values, keys and spelling."""
