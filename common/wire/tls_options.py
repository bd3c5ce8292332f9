"""The options of both programs that name certificates. Light, because ``--help`` must be instant."""

from typing import Final

OPTIONS: Final = {
    "--tls-ca": ("ATOLL_TLS_CA", "certificate of the authority that both sides trust"),
    "--tls-cert": ("ATOLL_TLS_CERT", "our certificate"),
    "--tls-key": ("ATOLL_TLS_KEY", "the certificate's private key, unencrypted"),
}
"""The option of each file, the environment variable in its place, and what the file is (all PEM)."""
