"""How near a rendered picture is to a filmed one: PSNR, SSIM and LPIPS, with and without what is not the object."""
