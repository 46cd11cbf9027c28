<#
.SYNOPSIS
    One run of semlive as a scheduled task on Windows: it survives the end of a remote session, and is started and stopped by hand.
.DESCRIPTION
    Install:   .\semlive-task.ps1 -Install -Config C:\semlive\al2024-01.yaml
    Start:     .\semlive-task.ps1 -Start     Stop: .\semlive-task.ps1 -Stop     State: .\semlive-task.ps1
    Remove:    .\semlive-task.ps1 -Remove
    The task has no trigger: a load frame is never moved by a clock or a restart of the computer, and starting it says that
    somebody stays at the instrument (--attended). A task that is ended by Windows ends hard; -Stop gives the run time to end by itself first.
#>
param(
    [switch]$Install, [switch]$Start, [switch]$Stop, [switch]$Remove,
    [string]$Config,
    [string]$Semlive = (Join-Path $env:ProgramData "semlive\venv\Scripts\semlive.exe"),
    [string]$Cache = (Join-Path $env:ProgramData "semlive\cache"),
    [string]$Name = "semlive",
    [int]$StopSeconds = 300
)
Set-StrictMode -Version Latest
$ErrorActionPreference = "Stop"

if ($Install) {
    if (-not (Test-Path -LiteralPath $Semlive)) { throw "$Semlive is not there; make it: py -m venv C:\ProgramData\semlive\venv, then pip install semlive in it" }
    if (-not $Config -or -not (Test-Path -LiteralPath $Config)) { throw "-Config names the configuration; write one: semlive init FILE" }
    $Config = (Resolve-Path -LiteralPath $Config).ProviderPath
    & $Semlive doctor $Config
    if ($LASTEXITCODE -ne 0) { throw "semlive doctor found something that is bad; mend it first" }
    New-Item -ItemType Directory -Force -Path $Cache | Out-Null
    [Environment]::SetEnvironmentVariable("NUMBA_CACHE_DIR", (Join-Path $Cache "jit"), "User")
    $action = New-ScheduledTaskAction -Execute $Semlive -Argument "run `"$Config`" --attended" -WorkingDirectory (Split-Path -Parent $Config)
    # No end after three days, no sleep, no second copy, no start by itself; battery does not matter to a load frame.
    $settings = New-ScheduledTaskSettingsSet -ExecutionTimeLimit ([TimeSpan]::Zero) -MultipleInstances IgnoreNew -AllowStartIfOnBatteries -DontStopIfGoingOnBatteries -Priority 5
    $principal = New-ScheduledTaskPrincipal -UserId "$env:USERDOMAIN\$env:USERNAME" -LogonType S4U -RunLevel Limited
    Register-ScheduledTask -TaskName $Name -Action $action -Settings $settings -Principal $principal -Force | Out-Null
    "installed; start it with -Start, and look at http://127.0.0.1:8765/"
}
elseif ($Start) { Start-ScheduledTask -TaskName $Name; "started" }
elseif ($Stop) {
    "the run has $StopSeconds s to end by itself; then the task is ended, and the load frame stops by its own watchdog"
    $until = (Get-Date).AddSeconds($StopSeconds)
    while ((Get-ScheduledTask -TaskName $Name).State -eq "Running" -and (Get-Date) -lt $until) { Start-Sleep -Seconds 1 }
    if ((Get-ScheduledTask -TaskName $Name).State -eq "Running") {
        Stop-ScheduledTask -TaskName $Name
        "ended hard: the load frame stopped by its own watchdog; semlive run CONFIG --resume takes the run up again"
    }
}
elseif ($Remove) { Unregister-ScheduledTask -TaskName $Name -Confirm:$false; "removed" }
else { (Get-ScheduledTask -TaskName $Name).State }
