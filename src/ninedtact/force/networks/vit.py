"""A small vision transformer (Dosovitskiy 2021, docs/references.md): patches of 10 pixels, mean of all tokens."""

import torch
from torch import Tensor, nn

PATCH_PX = 10
WIDTH = 192
HEADS = 3
DEPTH = 8


class VisionTransformer(nn.Module):
    """Images of any size → `outputs` numbers; places are told by sines, so that no size is learnt."""

    def __init__(self, channels: int, outputs: int) -> None:
        super().__init__()
        self.patches = nn.Conv2d(channels, WIDTH, PATCH_PX, PATCH_PX)
        layer = nn.TransformerEncoderLayer(
            WIDTH, HEADS, 4 * WIDTH, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
        )
        self.encoder = nn.TransformerEncoder(layer, DEPTH, nn.LayerNorm(WIDTH), enable_nested_tensor=False)
        self.head = nn.Linear(WIDTH, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(n, channels, h, w) → (n, outputs)."""
        tokens = self.patches(x)
        rows, cols = tokens.shape[-2:]
        tokens = tokens.flatten(2).transpose(1, 2) + places(rows, cols).to(tokens)
        return self.head(self.encoder(tokens).mean(1))


def places(rows: int, cols: int) -> Tensor:
    """Sines and cosines of every patch's row and column, (rows·cols, WIDTH)."""
    rates = 100.0 ** -torch.linspace(0, 1, WIDTH // 4)
    down, right = (torch.arange(side)[:, None] * rates for side in (rows, cols))
    of_row, of_col = (torch.cat([angle.sin(), angle.cos()], 1) for angle in (down, right))
    both = torch.cat([of_row[:, None].expand(-1, cols, -1), of_col[None].expand(rows, -1, -1)], 2)
    return both.reshape(rows * cols, WIDTH)
